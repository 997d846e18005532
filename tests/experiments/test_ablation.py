"""The ablations of the search."""

from __future__ import annotations

from dataclasses import asdict

from rtgs.base.json_records import to_json
from rtgs.experiments.ablation import ABLATION
from rtgs.experiments.rivals import OURS, OurMethod


def test_ablations_change_one_setting_each() -> None:
    def settings(method: OurMethod) -> dict[str, object]:
        return {**to_json(method.config), **asdict(method.comparison)}

    own = settings(OURS)
    for method in ABLATION:
        changed = [name for name, value in settings(method).items() if value != own[name]]
        assert changed == ["epsilon", "per_edge"] if method.key == "ours_paper_loss" else len(changed) == 1, method.key
    assert len({m.key for m in (OURS, *ABLATION)}) == len(ABLATION) + 1
