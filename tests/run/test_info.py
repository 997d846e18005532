"""`rtgs info` knows everything that a capture and a run are made of."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.helpers.made_up_run import SFM_PER_METRE, make_run

from rtgs.base.errors import RtgsError
from rtgs.cli import main
from rtgs.images.pictures import save_png, save_tiff
from rtgs.io.ply import write_ply
from rtgs.records.gaussians import Gaussians
from rtgs.run.info import describe, lines
from rtgs.synthetic import SynthConfig, write_capture

N = 5


@pytest.fixture(scope="module")
def small_capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("info") / "capture"
    write_capture(path, SynthConfig(frames=3, size=24, supersampling=1, thermal_clean=False, seed=1))
    return path


def test_a_capture_and_its_files(small_capture: Path) -> None:
    facts = describe(small_capture)
    assert (facts["kind"], facts["frames"], facts["unit"]) == ("capture", 3, "°C") and facts["poses"] == "3 came along"
    rig = describe(small_capture / "rig.json")
    assert rig["kind"] == "rig" and rig["baseline in metres"] == pytest.approx(facts["baseline in metres"])
    assert describe(small_capture / "transforms.json")["frames"] == 3
    picture = describe(next((small_capture / "thermal").iterdir()))
    assert picture["width"] == 24 and picture["numbers"]["least"] < picture["numbers"]["largest"]


def test_a_run_and_its_files(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    scale = describe(run / "scale.json")
    assert scale["SfM units per metre"] == SFM_PER_METRE and scale["status"] == "ok"
    scores = describe(run / "metrics.json")
    assert scores["thermal mae_c"] == 0.58
    if (run / "config.json").exists():
        assert describe(run)["thermal psnr"] == 31.84


def test_a_run_says_what_has_been_removed_from_it(run: Path) -> None:
    assert describe(run)["files missing"] == []
    (run / "thermal.ply").unlink()
    assert describe(run)["files missing"] == ["thermal.ply"]


def test_every_json_file_of_a_run_has_a_name(run: Path) -> None:
    kinds = {path.relative_to(run).as_posix(): describe(path)["kind"] for path in run.rglob("*.json")}
    assert len(kinds) > 5 and "JSON file" not in kinds.values(), kinds
    assert "thermal" in describe(run / "config.json")["settings of"]
    assert {"sfm", "evaluate"} <= set(describe(run / "stages.json")["stages done"])


def test_pictures_of_a_run_are_no_capture(run: Path) -> None:
    with pytest.raises(RtgsError, match="none of what rtgs knows"):
        describe(run / "renders")


def test_a_model(tmp_path: Path) -> None:
    means = torch.arange(3.0 * N).reshape(N, 3)
    write_ply(
        tmp_path / "a.ply",
        Gaussians(means, torch.ones(N, 4), torch.zeros(N, 3), torch.zeros(N), torch.zeros(N, 4, 1)),
        celsius_range=(10.0, 20.0),
    )
    facts = describe(tmp_path / "a.ply")
    assert facts["vertex"] == N and facts["holds"] == "Gaussians" and facts["harmonics of degree"] == 1
    assert facts["temperature"] == {"least": 15.0, "median": 15.0, "largest": 15.0} and facts["x"]["largest"] == 12.0


@pytest.mark.parametrize("name", ["nothing.xyz", "folder"])
def test_what_is_not_known_is_refused_with_what_is(name: str, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "nothing.xyz").touch()
    with pytest.raises(RtgsError, match="run folder, COLMAP model, capture"):
        describe(tmp_path / name)


@pytest.mark.parametrize("content", [b"", b"ply\nformat", b"{"])
@pytest.mark.parametrize("name", ["a.ply", "a.json", "scale.json", "spots.json", "rig.json", "a.png"])
def test_damaged_files_are_named(name: str, content: bytes, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RtgsError, match=name):
        describe(tmp_path / name)


def test_json_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_png(tmp_path / "a.png", np.zeros((4, 6, 3), np.uint8))
    main(["info", str(tmp_path / "a.png"), "--json"])
    assert json.loads(capsys.readouterr().out)["width"] == 6
    save_tiff(tmp_path / "b.tiff", np.full((4, 6), 21.5, np.float32))
    main(["info", str(tmp_path / "b.tiff")])
    assert "numbers: least 21.5, median 21.5, largest 21.5" in capsys.readouterr().out
    assert lines({"a": [], "b": ["x y", "z"], "c": 1.23456789}) == ["b: x y", "b: z", "c: 1.23457"]
