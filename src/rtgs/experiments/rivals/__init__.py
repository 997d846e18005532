"""The scale's rivals: losses that take the place of the paper's, each a value of one type; and this package's own answer as one."""

from rtgs.experiments.rivals.inerf_l1 import INERF_L1
from rtgs.experiments.rivals.inerf_ssim import INERF_SSIM
from rtgs.experiments.rivals.losses import ImageLoss, LossOf, Rival, RivalObjective
from rtgs.experiments.rivals.mutual_information import MUTUAL_INFORMATION
from rtgs.experiments.rivals.ngf_pyramid import NGF_PYRAMID
from rtgs.experiments.rivals.ngf_single import NGF_SINGLE
from rtgs.experiments.rivals.ours import OURS, OURS_REFINED, OurMethod

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
    "OurMethod",
    "Rival",
    "RivalObjective",
]
