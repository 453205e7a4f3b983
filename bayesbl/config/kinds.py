"""Every kind of run, and the model of its configuration."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from bayesbl.config.diagnose import DiagnoseConfig
from bayesbl.config.measurement import CompareConfig, FitConfig
from bayesbl.config.sections import RunConfig
from bayesbl.config.study import StudyConfig
from bayesbl.config.sweep import SweepConfig

KINDS: Mapping[str, type[RunConfig]] = MappingProxyType(
    {
        "fit": FitConfig,
        "compare": CompareConfig,
        "sweep": SweepConfig,
        "diagnose": DiagnoseConfig,
        "study": StudyConfig,
    }
)
"""Kind to the model of its configuration."""
