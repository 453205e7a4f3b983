"""Every kind of run, and the model of its configuration."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from bayesbl.config.diagnose import DiagnoseConfig
from bayesbl.config.schema import CompareConfig, FitConfig, RunConfig, StudyConfig, SweepConfig

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
