"""The paper's loss without its pyramid: Eq. 6 at full size."""

from __future__ import annotations

from rtgs.experiments.rivals.losses import Rival
from rtgs.experiments.rivals.ngf_pyramid import Ngf
from rtgs.losses.edge_loss import EdgeLoss

NGF_SINGLE = Rival("ngf_single", "NGF single scale", lambda thermal, mask: Ngf(thermal, mask, EdgeLoss(level_weights=(1.0,))))
