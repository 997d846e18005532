"""Ways to place the thermal camera, one file each: the rows of `rtgs experiment real`.

To add a row, write a file that defines a `Strategy`, and list it here.
"""

from rtgs.experiments.strategies.manual import MANUAL
from rtgs.experiments.strategies.metric_depth import METRIC_DEPTH
from rtgs.experiments.strategies.metric_poses import MAST3R
from rtgs.experiments.strategies.naive import NAIVE
from rtgs.experiments.strategies.ours import OURS
from rtgs.experiments.strategies.planar import PLANAR
from rtgs.experiments.strategies.strategy import Given, Placement, Strategy

STRATEGIES: tuple[Strategy, ...] = (MANUAL, NAIVE, MAST3R, METRIC_DEPTH, PLANAR, OURS)
"""In the order of the table's rows, which is the paper's."""

__all__ = ["STRATEGIES", "Given", "Placement", "Strategy"]
