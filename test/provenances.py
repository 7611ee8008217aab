"""Subjects with the provenance of a fit: covariance of the parameters, and the usual residual."""

from __future__ import annotations

import dataclasses

import numpy as np

from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body import parameter_spread, usual_residual
from biodyn_core.body.parameter_spread import NAMES, ParameterSpread
from biodyn_core.body.subject import Subject
from biodyn_core.body.usual_residual import UsualResidual
from biodyn_core.signals.octaves import N_BANDS


def with_spread(subject: Subject, share: float = 0.1, spread: float = 0.03, noise_mps2: float = 0.02) -> Subject:
    """The subject with parameters known within e^spread each, and a model that misses a share of every band."""
    law = UsualResidual((noise_mps2,) * N_BANDS, (share,) * N_BANDS, 100)
    provenance = {
        parameter_spread.PROVENANCE: ParameterSpread(NAMES[:14], spread**2 * np.eye(14)).to_dict(),
        **usual_residual.to_provenance(dict.fromkeys(MEASURED_SEGMENTS, law)),
    }
    return dataclasses.replace(subject, provenance=provenance)
