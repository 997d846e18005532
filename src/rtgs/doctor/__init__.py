"""What can be said of a capture before any work: whether it can be used, and what to change at the next one."""

from rtgs.doctor.examination import examine
from rtgs.doctor.records import Diagnosis, Finding

__all__ = ["Diagnosis", "Finding", "examine"]
