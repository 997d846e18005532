"""The inspection report: one HTML file for the client, made from a run, a list of spots and a file of facts that the user fills."""

from rtgs.run.inspection.facts import InspectionFacts, read_facts, write_empty_facts
from rtgs.run.inspection.page import write_inspection
from rtgs.run.inspection.pdf import print_pdf

__all__ = ["InspectionFacts", "print_pdf", "read_facts", "write_empty_facts", "write_inspection"]
