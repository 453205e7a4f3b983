"""Every kind of file, and the model of those that describe a run."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from bayesbl.config.diagnose import DiagnoseConfig
from bayesbl.config.fleet import FleetConfig
from bayesbl.config.identify import IdentifyConfig
from bayesbl.config.measurement import CompareConfig, FitConfig
from bayesbl.config.plan import PlanConfig
from bayesbl.config.sections import RunConfig
from bayesbl.config.study import StudyConfig
from bayesbl.config.sweep import SweepConfig

KINDS: Mapping[str, type[RunConfig]] = MappingProxyType(
    {
        "fit": FitConfig,
        "compare": CompareConfig,
        "sweep": SweepConfig,
        "plan": PlanConfig,
        "diagnose": DiagnoseConfig,
        "identify": IdentifyConfig,
        "study": StudyConfig,
        "fleet": FleetConfig,
    }
)
"""Kind to the model of its configuration."""

FILES: Mapping[str, str] = MappingProxyType(
    {
        "fit": "one recording to be measured",
        "compare": "recordings to be measured and compared",
        "simulate": "recordings to be made on a bench",
        "sweep": "a bench to be swept over its gap",
        "plan": "a bench whose motions are to be ranked",
        "diagnose": "recordings, and the bench that should describe them",
        "identify": "recordings, and the data sheet that a bench is identified from",
        "study": "an experiment and its rows",
        "fleet": "an inventory of joints, and where their recordings are",
        "bench": "a virtual bench",
    }
)
"""Kind to what a file of this kind holds, in words."""

RUNNABLE = tuple(kind for kind in FILES if kind != "bench")
"""The kinds that ``bayesbl run`` takes."""
