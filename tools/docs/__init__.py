"""Generated documentation: the reference pages of vehicle, rig and scenario files."""

from pathlib import Path

from tools.docs.rig import rig_page
from tools.docs.scenario import scenario_page
from tools.docs.vehicle import vehicle_page

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = {"vehicle.md": vehicle_page, "rig.md": rig_page, "scenario.md": scenario_page}
