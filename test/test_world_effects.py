"""The independent simulation of effects: what it is made of, and its motion with and without an effect."""

import ast
import dataclasses
import itertools
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hidden_forms import EVERY, PERSON, made, moment, of_kind, shaken
from scipy import interpolate
from world import body, seats, sensors
from world.effects import development_forms, moving, third_forms, wearing
from world.effects.background import NOTHING
from world.effects.draw import KINDS, forms
from world.effects.effect import Effect, Person
from world.effects.event import HELD_HZ

WORLD = Path(__file__).parent / "world"


def test_the_world_of_effects_shares_nothing_with_the_package() -> None:
    allowed = {*sys.stdlib_module_names, "numpy", "scipy", "mcap", "world", "typing_extensions"}
    for path in WORLD.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert {name.split(".")[0] for name in names} <= allowed, path


def test_splits_are_disjoint_and_each_has_every_class() -> None:
    splits = {split: forms(split) for split in ("development", "second", "earlier", "third")}
    for (_, ours), (_, theirs) in itertools.combinations(splits.items(), 2):
        assert not set(ours) & set(theirs) and not {f.__name__ for f in ours} & {f.__name__ for f in theirs}
    for split, found in splits.items():
        assert {f.__module__ for f in found} == {f"world.effects.{split}_forms"}
        assert {form.kind for form in found} == {*KINDS, "outside"}
    assert len({(form.kind, form.family) for form in EVERY}) == len(KINDS) + 1


def test_drawing_for_development_does_not_even_import_the_forms_for_scoring() -> None:
    code = (
        "import sys, numpy as np; from world.effects import draw, sitting\n"
        "draw.effect('development', np.random.default_rng(0))\n"
        "draw.effect('second', np.random.default_rng(0))\n"
        "draw.effect('earlier', np.random.default_rng(0))\n"
        "sys.exit('world.effects.third_forms' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=WORLD.parent, check=False).returncode == 0


@pytest.mark.parametrize("form", EVERY)
def test_draws_stay_in_their_ranges_and_truth_is_plain(form: type[Effect]) -> None:
    for seed in range(5):
        one = made(form, seed)
        assert one.site in form.sites and form.strengths[0] <= one.strength <= form.strengths[1]
        assert {type(value) for value in one.truth().values()} <= {str, int, float}
    assert form.__doc__ and form.__doc__.rstrip(".").endswith(form.kind)


# --- moving ----------------------------------------------------------------------------------------------------------


def test_bodies_without_effects_match_dop853(no_rest: None) -> None:
    people, happens = body.drawn(2, np.random.default_rng(1)), shaken()
    seat = happens.accel_mps2[:, 2]
    expected = body.accelerations(people, seats.RATE_HZ, np.column_stack([seat, seat]))[:, ::2]
    found = moving.moved([moving.Party(Person.of(people, i), [happens]) for i in range(2)])
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.accel_mps2[0], other, atol=2e-5 * np.abs(expected).max())


@cache
def answers() -> tuple[np.ndarray, dict[type[Effect], np.ndarray], dict[type[Effect], np.ndarray]]:
    """The shaken body: plain, with nothing of each form, and with each form."""
    none = [dataclasses.replace(made(form), strength=0.0) for form in EVERY]
    parties = [moving.Party(PERSON, [shaken()], (one,)) for one in [*none, *map(made, EVERY)]]
    plain, *found = moving.moved([moving.Party(PERSON, [shaken()]), *parties])
    accel = [one.accel_mps2[0] for one in found]
    count = len(EVERY)
    return (
        plain.accel_mps2[0],
        dict(zip(EVERY, accel[:count], strict=True)),
        dict(zip(EVERY, accel[count:], strict=True)),
    )


SENSOR_KINDS = ("skin", "tilt", "clock", "gain", "saturation")


@pytest.mark.parametrize("form", EVERY)
def test_zero_strength_is_the_base_simulation(form: type[Effect], no_rest: None) -> None:
    plain, none, _ = answers()
    np.testing.assert_allclose(none[form], plain, atol=1e-9 * np.abs(plain).max())
    nothing, up = dataclasses.replace(made(form), strength=0.0), plain[:, made(form).site - 1]
    for ours, theirs in zip(*(sent(effects, up, made(form).site) for effects in ((), (nothing,))), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


@pytest.mark.parametrize("form", EVERY)
def test_a_strength_above_zero_changes_the_simulation(form: type[Effect], no_rest: None) -> None:
    plain, _, some = answers()
    assert np.isfinite(some[form]).all()
    moves = np.abs(some[form] - plain).max() / np.abs(plain).max()
    one = made(form)
    before, after = (sent(effects, plain[:, one.site - 1], one.site)[1] for effects in ((), (one,)))
    if form.kind in SENSOR_KINDS:
        assert moves == 0.0
        if form.kind != "saturation":
            assert np.abs(after - before).max() > 0.01
    else:
        assert 1e-3 < moves < 5.0
        np.testing.assert_array_equal(after, before)


def sent(effects: tuple[Effect, ...], up: np.ndarray, site: int) -> wearing.Stream:
    imu = sensors.Imu(np.eye(3), np.zeros(3), 0.0)
    return wearing.stream(max(site, 1), imu, shaken(), up, effects, NOTHING, np.random.default_rng(0))


@pytest.mark.slow
def test_a_four_times_finer_step_changes_little_even_at_kinks(no_rest: None, monkeypatch: pytest.MonkeyPatch) -> None:
    kinds = ("stop", "friction", "hysteresis", "lift_off", "harness", "quadratic_damping", "reflex", "thixotropy")
    chosen = [made(form) for form in of_kind(*kinds, among=EVERY)]
    coarse = moving.moved([moving.Party(PERSON, [shaken()], (one,)) for one in chosen])
    happens = shaken()
    fine_s = np.linspace(0.0, happens.time_s[-1], 4 * (len(happens.time_s) - 1) + 1)
    curve = interpolate.CubicSpline(happens.time_s, happens.accel_mps2)(fine_s)
    finer = dataclasses.replace(happens, accel_mps2=curve, angle_rad=np.zeros((len(curve), 2)))
    monkeypatch.setattr(moving, "STEP_S", 0.25 / HELD_HZ)
    fine = moving.moved([moving.Party(PERSON, [finer], (one,)) for one in chosen])
    for effect, one, other in zip(chosen, coarse, fine, strict=True):
        accel = other.accel_mps2[0][::4]
        assert np.abs(one.accel_mps2[0] - accel).max() < 2e-3 * np.abs(accel).max(), effect


def test_delays_interpolate_by_cubic_polynomials() -> None:
    effect = made(development_forms.LatePull)
    acting = moving._Acting(effect, moving.Party(PERSON, [shaken()], (effect,)), slice(0, 1), 12, 4001)
    t = np.arange(acting.memory.shape[1]) * moving.STEP_S
    acting.memory[0, :, 0, 0], acting.memory[1, :, 0, 0] = np.sin(60.0 * t), 60.0 * np.cos(60.0 * t)
    assert acting._recalled(100.37)[0, 0] == pytest.approx(np.sin(60.0 * 100.37 * moving.STEP_S), abs=1e-8)
    assert acting._recalled(-3.0)[0, 0] == 0.0


FROM_THE_SEAT = (third_forms.TetheredHead, third_forms.AbsorberUnderThePan, third_forms.ArmsOnTheWheel)
"""Effects of no class that act from the seat, so that their forces on the body have a sum."""


@pytest.mark.parametrize(
    "form",
    [f for f in EVERY if f.family in ("elastic", "rubbing", "drifting", "outside") and f not in FROM_THE_SEAT],
)
def test_forces_between_segments_are_equal_and_opposite(form: type[Effect]) -> None:
    one = dataclasses.replace(made(form), site=form.sites[-1])
    now = moment(-PERSON.reach_m[one.site], 0.01)
    now.share[:] = 1.0
    one.act(now, np.full((1, one.states), 1e-3))
    assert now.up_n.any()
    if one.site or form.kind == "outside":
        assert now.up_n.sum() == pytest.approx(0.0, abs=1e-9 * np.abs(now.up_n).max())
