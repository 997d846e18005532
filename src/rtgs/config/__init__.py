"""Every setting of every stage, with its default: one file a stage.

Nothing heavy is imported here, so that the command line can show all settings before it loads torch.
"""

from rtgs.config.calibration import BoardConfig, BoardKind
from rtgs.config.experiments import (
    SYNTHETIC_TABLES,
    ManualConfig,
    RealExperimentConfig,
    SyntheticExperimentConfig,
    SyntheticTable,
)
from rtgs.config.export import ExportConfig, ExportFormat, ExportFrame, Plane, Program, ThermalColours
from rtgs.config.metres import METRES_SOURCES, MetresConfig, TagsConfig
from rtgs.config.rgb import QUALITIES, Backend, DensifyConfig, Quality, RgbConfig
from rtgs.config.run import RunConfig
from rtgs.config.scale import PAPER_EPSILON, PAPER_LEVEL_WEIGHTS, REFINABLE, ScaleConfig
from rtgs.config.sfm import SfmConfig
from rtgs.config.spots import SpotsConfig
from rtgs.config.synthetic import FEATURES, SCENES, SceneName, SynthConfig
from rtgs.config.thermal import DriftKind, DriftSetting, GeometrySetting, ThermalConfig

__all__ = [
    "FEATURES",
    "METRES_SOURCES",
    "PAPER_EPSILON",
    "PAPER_LEVEL_WEIGHTS",
    "QUALITIES",
    "REFINABLE",
    "SCENES",
    "SYNTHETIC_TABLES",
    "Backend",
    "BoardConfig",
    "BoardKind",
    "DensifyConfig",
    "DriftKind",
    "DriftSetting",
    "ExportConfig",
    "ExportFormat",
    "ExportFrame",
    "GeometrySetting",
    "ManualConfig",
    "MetresConfig",
    "Plane",
    "Program",
    "Quality",
    "RealExperimentConfig",
    "RgbConfig",
    "RunConfig",
    "ScaleConfig",
    "SceneName",
    "SfmConfig",
    "SpotsConfig",
    "SynthConfig",
    "SyntheticExperimentConfig",
    "SyntheticTable",
    "TagsConfig",
    "ThermalColours",
    "ThermalConfig",
]
