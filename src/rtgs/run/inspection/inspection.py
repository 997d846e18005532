"""What an inspection report is made from. Every part may be missing, and then the report says which."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import read_record
from rtgs.config import ExportConfig
from rtgs.doctor import Diagnosis, examine
from rtgs.io.camera_tags import CameraTags, read_camera_tags
from rtgs.io.exports.frames import FileFrame
from rtgs.io.exports.subject import Subject
from rtgs.io.image_files import list_images
from rtgs.records.radiometry import ObjectParameters, PlanckRadiometry
from rtgs.records.spots import SpotList
from rtgs.run.export import subject_of
from rtgs.run.folder import RunFolder
from rtgs.run.inspection.facts import InspectionFacts
from rtgs.run.inspection.words import Words
from rtgs.run.report.run_records import RunRecords

_MODEL_FILES = ("thermal.ply", "scale.json")


@dataclass(frozen=True, eq=False)
class Inspection:
    """The parts of a report.

    Attributes:
        run: the records of the run. facts: what the user states. facts_given: whether a file of facts was named.
        words: the catalogue of texts.
        spots_folder: what `rtgs spots` wrote. spots: its list; None where there is none.
        subject: scene and models; None where they cannot be read. why_not: the reason.
        diagnosis: what `rtgs doctor` says of the capture; None where it cannot be read.
    """

    run: RunRecords
    facts: InspectionFacts
    facts_given: bool
    words: Words
    spots_folder: Path
    spots: SpotList | None
    subject: Subject | None
    why_not: str = ""
    diagnosis: Diagnosis | None = None

    @staticmethod
    def read(run: Path, facts: InspectionFacts | None, spots_folder: Path, words: Words) -> Inspection:
        """Read what is there. Scene and models may be missing; records that are damaged may not.

        Raises:
            RtgsError: a record or the list of spots is damaged.
        """
        records = RunRecords.read(run)
        path = spots_folder / "spots.json"
        spots = read_record(SpotList, path, remedy="Make it again with `rtgs spots`.") if path.is_file() else None
        folder, subject, why_not = RunFolder(run), None, ""
        try:
            subject = subject_of(folder, folder.load_scene(), ExportConfig())
        except RtgsError as error:
            why_not = str(error)
        diagnosis = None if subject is None else examine(subject.scene.capture)
        return Inspection(
            records, facts or InspectionFacts(), facts is not None, words, spots_folder, spots, subject, why_not, diagnosis
        )

    @property
    def spots_command(self) -> str:
        """The command that makes the list of spots."""
        return f"rtgs spots {shlex.quote(str(self.run.path))} --out {shlex.quote(str(self.spots_folder))}"

    @property
    def spots_are_older(self) -> bool:
        """Whether the run's model was written after the list."""
        listed = (self.spots_folder / "spots.json").stat().st_mtime
        return any(p.is_file() and p.stat().st_mtime > listed for p in (self.run.path / name for name in _MODEL_FILES))

    @cached_property
    def frame(self) -> FileFrame | None:
        """Metres with z up, as far as known: the frame of plan and positions."""
        return None if self.subject is None else self.subject.frame("z-up", fixed=True)

    @property
    def used(self) -> ObjectParameters | None:
        """The object parameters that temperatures were computed with; None where the files do not say."""
        radiometry = None if self.subject is None else self.subject.scene.capture.radiometry
        return radiometry.parameters if isinstance(radiometry, PlanckRadiometry) else None

    @cached_property
    def rgb_tags(self) -> tuple[CameraTags, CameraTags]:
        """Of the first and of the last RGB photograph."""
        return self._tags("rgb")

    @cached_property
    def thermal_tags(self) -> CameraTags:
        """Of the first thermal file. Both pictures of a radiometric JPEG are by one camera, which the RGB file then names."""
        own, rgb = self._tags("thermal")[0], self.rgb_tags[0]
        return rgb if not own.camera and self.used is not None else own

    def _tags(self, folder: str) -> tuple[CameraTags, CameraTags]:
        if self.run.capture is None or not (self.run.capture / folder).is_dir():
            return CameraTags(), CameraTags()
        try:
            images = list(list_images(self.run.capture / folder).values())
            first, last = read_camera_tags(images[0]), read_camera_tags(images[-1])
        except (RtgsError, IndexError):  # a photograph that is damaged now; its tags are an extra
            return CameraTags(), CameraTags()
        return first, last
