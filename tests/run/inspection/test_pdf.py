"""The PDF beside the page."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from tests.helpers.inspection_pages import write_spots
from tests.helpers.made_up_run import make_run

from rtgs.base.errors import RtgsError
from rtgs.run.inspection import print_pdf, write_inspection
from rtgs.run.inspection.pdf import find_browser


def program(path: Path, body: str) -> str:
    path.write_text(f"#!{sys.executable}\nimport sys\n{body}\n", encoding="utf-8")
    path.chmod(0o755)
    return str(path)


PRINTS = "open(next(a for a in sys.argv if a.startswith('--print-to-pdf=')).split('=', 1)[1], 'w').write(sys.argv[-1])"


@pytest.mark.skipif(sys.platform == "win32", reason="a script with a first line that names its interpreter")
def test_a_browser_prints_the_page_and_one_that_fails_leaves_no_file(tmp_path: Path) -> None:
    page = tmp_path / "a b.html"
    page.write_text("<p>", encoding="utf-8")
    out = print_pdf(page, program(tmp_path / "good", PRINTS))
    assert out == tmp_path / "a b.pdf" and out.read_text() == page.as_uri()
    out.unlink()
    with pytest.raises(RtgsError, match="no display"):
        print_pdf(page, program(tmp_path / "bad", "sys.exit('no display')"))
    with pytest.raises(RtgsError, match="does not print"):
        print_pdf(page, program(tmp_path / "idle", ""))
    with pytest.raises(RtgsError, match="print it to a PDF"):
        print_pdf(page, str(tmp_path / "absent"))
    assert not out.exists()


def test_without_a_browser_the_remedy_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(RtgsError, match=r"neither Chromium nor Chrome is installed. Open .*a\.html in any browser"):
        print_pdf(tmp_path / "a.html")


@pytest.mark.thorough
@pytest.mark.skipif(find_browser() is None, reason="no Chromium or Chrome is installed")
def test_the_report_is_printed(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    write_spots(run / "spots")
    pdf = print_pdf(write_inspection(run, tmp_path / "inspection.html")).read_bytes()
    assert pdf.startswith(b"%PDF") and pdf.count(b"/Type /Page\n") >= 2
