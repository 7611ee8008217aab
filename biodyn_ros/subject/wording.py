"""Wording: each step's result in one sentence, for the terminal and the page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any, Final

from biodyn_core.base.wording import counted, number
from biodyn_ros.base.wording import duration
from biodyn_ros.subject.making import EVENTS, FITTED, MadeSubject
from biodyn_ros.subject.steps import Step
from biodyn_ros.subject.uses import UsedEvents

TITLES: Final = {"events": "Events", "fit": "Fit", "validate": "Validation", "trace": "Missing effect"}
PAGES: Final = {"events": "events.html", "fit": "fitted.fit.html", "trace": "trace/trace.html"}
FILES: Final = {"events": EVENTS, "fit": FITTED, "trace": "trace/trace.json"}


def sentence_of(step: Step, used: UsedEvents | None) -> str:
    """The result of a step, or the reason for its absence."""
    if step.state != "done":
        return step.reason
    return _SENTENCES[step.name](step.facts, used)


def divergence_of(facts: Mapping[str, Any]) -> str:
    """In how many events the model of a fit diverges; empty if in none, and for other steps."""
    unstable = facts.get("unstable_events", 0)
    return f"the fitted model diverges in {counted(unstable, 'event')}" if unstable else ""


def _events(facts: Mapping[str, Any], used: UsedEvents | None) -> str:
    session = f"{duration(facts['seconds'], at_most=True)} with {counted(facts['rests'], 'rest')}"
    if used is None:
        return session
    counts = Counter(used.uses.values())
    events = counted(len(used.uses) + used.unused, "event")
    uses = f"{counts['fit']} to fit, {counts['choose']} to choose an effect, {counts['report']} only predicted"
    return f"{events} in {session}; {len(used.uses)} of them are used: {uses}"


def _fit(facts: Mapping[str, Any], used: UsedEvents | None) -> str:
    to_fit, fitted = len(used.fit) if used else 0, facts["fitted_events"]
    some = f"fitted to the representative event of each condition, {fitted} of {to_fit}"
    means = {"fitted to": facts["fitted_percent"], "not fitted to": facts["held_out_percent"]}
    known = [f"{number(mean)} % of the rms in the events {which}" for which, mean in means.items() if mean is not None]
    mean = f"mean error {', '.join(known)}" if known else ""
    return "; ".join(filter(None, (some if fitted < to_fit else "", divergence_of(facts), mean, *facts["clocks"])))


def _validate(facts: Mapping[str, Any], _: UsedEvents | None) -> str:
    if not facts["events"]:
        return "no event is left to validate on: a condition with three events has one"
    verdicts = Counter(event["verdict"] for event in facts["events"])
    known = [event["mean_percent"] for event in facts["events"] if event["mean_percent"] is not None]
    each = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
    mean = f"; mean error {number(sum(known) / len(known))} %" if known else ""
    if known and len(known) < len(facts["events"]):
        mean += f" in the {len(known)} compared"
    return f"{counted(len(facts['events']), 'event')} that nothing was fitted to: {each}{mean}"


def _trace(facts: Mapping[str, Any], used: UsedEvents | None) -> str:
    found = str(facts["headline"]).rstrip(".")
    changed = used.changed(facts.get("uses")) if used else {}
    return f"{found}; {counted(len(changed), 'event')} not used as dealt" if changed else found


_SENTENCES: Final = {"events": _events, "fit": _fit, "validate": _validate, "trace": _trace}


def result_line(made: MadeSubject) -> str:
    """The subject that results, or why there is none."""
    trace, fit = made.steps["trace"], made.steps["fit"]
    if fit.state != "done":
        return "there is no resulting subject: nothing was fitted"
    if trace.state == "done" and trace.facts["adds"]:
        return "the resulting subject has the fitted parameters and the added effect"
    return "the resulting subject has the fitted parameters, without an added effect"
