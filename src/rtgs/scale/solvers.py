"""The solvers that `ScaleConfig.solver` names.

Another one is a value with `solve(problem) -> Found` in a file of its own, an entry here, and its name in `rtgs.config.scale.SolverName`.
"""

from __future__ import annotations

from collections.abc import Mapping

from rtgs.scale.adam import Adam
from rtgs.scale.global_search import GlobalSearch
from rtgs.scale.problem import Solver

SOLVERS: Mapping[str, Solver] = {"global": GlobalSearch(), "adam": Adam()}
