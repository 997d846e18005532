"""The scale's rivals: losses that take the place of the paper's, each a value of one type; and this package's own answer as one."""

from rtgs.baselines.inerf_l1 import INERF_L1
from rtgs.baselines.inerf_ssim import INERF_SSIM
from rtgs.baselines.losses import ImageLoss, LossOf, Rival, RivalObjective
from rtgs.baselines.mutual_information import MUTUAL_INFORMATION
from rtgs.baselines.ngf_pyramid import NGF_PYRAMID
from rtgs.baselines.ngf_single import NGF_SINGLE
from rtgs.baselines.ours import OURS, OURS_REFINED, Own

RIVALS: tuple[Rival, ...] = (INERF_SSIM, INERF_L1, NGF_SINGLE, NGF_PYRAMID, MUTUAL_INFORMATION)

__all__ = [
    "INERF_L1",
    "INERF_SSIM",
    "MUTUAL_INFORMATION",
    "NGF_PYRAMID",
    "NGF_SINGLE",
    "OURS",
    "OURS_REFINED",
    "RIVALS",
    "ImageLoss",
    "LossOf",
    "Own",
    "Rival",
    "RivalObjective",
]
