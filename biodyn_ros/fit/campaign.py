"""Campaigns: fits of many subjects on an executor; the results of each are written when it finishes.

One subject is one task. The worker reads its bags, so their paths must be valid on every worker.
"""

from __future__ import annotations

import dataclasses
from concurrent.futures import Executor
from pathlib import Path

from biodyn_core.base.errors import InputError, one_line
from biodyn_ros.base.files import make_directory
from biodyn_ros.base.json_files import finite
from biodyn_ros.base.progress import OnProgress, ignore_progress, silent
from biodyn_ros.fit.campaign_file import Campaign, Entry
from biodyn_ros.fit.campaign_results import CampaignReport, Results, SubjectFit, fingerprint
from biodyn_ros.fit.document import fit_document, fitted_subject
from biodyn_ros.fit.fitting import FitOptions, check_profiles, fit_bags
from biodyn_ros.fit.summary import summary_of
from biodyn_ros.work.executors import as_done
from biodyn_ros.work.tasks import Work


def fit_campaign(
    campaign: Campaign,
    directory: Path,
    options: FitOptions | None = None,
    executor: Executor | None = None,
    resume: bool = False,
    progress: OnProgress = ignore_progress,
    report: bool = False,
) -> CampaignReport:
    """Fit all subjects into a directory with their campaign.json, which is rewritten after each.

    Each subject has its own held-out bags and cases. A subject that fails is `failed`; the others continue. With resume
    a subject with a result is not fitted again. progress receives (bags of finished subjects, bags in all).

    Raises InputError for a directory with a campaign if resume is not set, for a result in it of another fit or of no
    campaign, for results that would overwrite inputs of the campaign, and if campaign.json cannot be written.
    """
    o = options or FitOptions()
    check_profiles(o)
    results = Results(campaign, directory)
    if results.path.exists() and not resume:
        raise InputError(f"{results.path}: holds a campaign; give --resume to continue it, or another directory")
    results.load(o)
    make_directory(directory)
    results.write()
    waiting = results.waiting
    progress(*results.progress)
    for index, future in as_done(executor, [(fit_one, (entry, o, report)) for entry in waiting]):
        results.add(waiting[index], future)
        progress(*results.progress)
    return results.report


def fit_one(entry: Entry, options: FitOptions, draw: bool) -> SubjectFit:
    """Fit one subject on the worker, reading its bags, and draw its page; raises InputError as `fit_bags`."""
    own = dataclasses.replace(options, held_out=entry.held_out, cases=entry.cases)
    key = fingerprint(entry, options)  # of the bags as they are before the fit
    report = fit_bags(entry.bags, entry.subject, own, Work(monitor=silent))
    mean_error_percent = finite(summary_of(report).fitted_percent)
    subject = fitted_subject(report).to_yaml()
    fit = SubjectFit(key, fit_document(report), subject, report.seconds, mean_error_percent)
    if not draw:
        return fit
    try:
        from biodyn_ros.fit.page import fit_page  # an extra of its own

        return dataclasses.replace(fit, page=fit_page(report))
    except Exception as error:  # noqa: BLE001 - a fault in a drawing must not discard the fit
        return dataclasses.replace(fit, page_fault=f"the page cannot be drawn ({one_line(error)})")
