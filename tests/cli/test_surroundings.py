"""What a command does where its surroundings are odd: a pipe that closes, names that are no text, no place for a cache."""

from __future__ import annotations

import os
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

from rtgs.cli import main
from rtgs.io.image_files import list_images

pytestmark = [pytest.mark.thorough, pytest.mark.skipif(sys.platform != "linux", reason="names of any bytes, and /proc")]
RTGS = [sys.executable, "-m", "rtgs"]
SYNTH = ["synth", "--frames", "3", "--size", "16", "--supersampling", "1", "--no-thermal-clean"]


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["--version"], [*SYNTH, "--out", "OUT"]])
def test_whoever_reads_the_output_may_end_early(arguments: list[str], tmp_path: Path) -> None:
    command = [*RTGS, *(str(tmp_path / "capture") if a == "OUT" else a for a in arguments)]
    reader, writer = os.pipe()
    os.close(reader)
    ended = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True)
    os.close(writer)
    assert (ended.returncode, ended.stderr) == (141, "")


def test_a_folder_whose_name_is_no_text(tmp_path: Path) -> None:
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/gr\xfcn"))
    folder.mkdir()
    subprocess.run([*RTGS, *SYNTH, "--out", "capture"], cwd=tmp_path, check=True, stdout=subprocess.DEVNULL)
    (tmp_path / "capture").rename(folder / "capture")
    for name, said in (("none", b"no such folder"), ("capture", b"is not UTF-8. Rename")):
        ended = subprocess.run([*RTGS, "run", str(folder / name), "--out", "run"], cwd=tmp_path, capture_output=True)
        assert ended.returncode == 2 and said in ended.stderr and b"Traceback" not in ended.stderr
        assert ended.stderr.startswith(b"error: ") and ended.stderr.count(b"\n") == 1


def test_a_photograph_whose_name_is_no_text(tmp_path: Path) -> None:
    Path(os.fsdecode(os.fsencode(tmp_path) + b"/gr\xfcn.png")).touch()
    with pytest.raises(Exception, match=r"gr\\udcfcn\.png', which is not UTF-8 text"):
        list_images(tmp_path)


def test_a_photograph_of_too_many_pixels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([*SYNTH, "--out", str(tmp_path / "capture")])
        path = tmp_path / "capture" / "rgb" / "frame_001.png"
        png = path.read_bytes()
        size = (20_000).to_bytes(4, "big") + (10_000).to_bytes(4, "big")
        header = b"IHDR" + size + png[24:29]
        path.write_bytes(png[:12] + header + zlib.crc32(header).to_bytes(4, "big") + png[33:])
        main(["run", str(tmp_path / "capture"), "--out", str(tmp_path / "run")])
    error = capsys.readouterr().err
    assert stop.value.code == 2 and "frame_001.png: has more than 179 megapixels" in error and error.count("\n") == 1


def test_without_a_place_for_compiled_code(tmp_path: Path) -> None:
    code = (
        "from rtgs.base.compiled import kernel\nfrom rtgs.base.errors import RtgsError\n"
        "names = {}\nexec(compile('def twice(x):\\n    return 2 * x\\n', '/proc/kernels.py', 'exec'), names)\n"
        "try:\n    kernel()(names['twice'])\nexcept RtgsError as error:\n    print(error)\n"
    )
    nowhere = {"HOME": "/proc/none", "XDG_CACHE_HOME": "/proc/none", "NUMBA_CACHE_DIR": ""}
    ended = subprocess.run([sys.executable, "-c", code], env={**os.environ, **nowhere}, capture_output=True, text=True)
    assert "Set NUMBA_CACHE_DIR" in ended.stdout, ended.stderr
