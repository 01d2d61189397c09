"""Generated documentation: the reference pages of the manual."""

from pathlib import Path

from tools.docs.c_interface import c_interface_page
from tools.docs.campaign_file import campaign_file_page
from tools.docs.command_line import command_line_page
from tools.docs.database import database_page
from tools.docs.equations import equations_page
from tools.docs.http_api import http_api_page
from tools.docs.json_results import json_page
from tools.docs.map_file import map_file_page
from tools.docs.rig import rig_page
from tools.docs.scenario import scenario_page
from tools.docs.signals import signals_page
from tools.docs.vehicle import vehicle_page

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = {
    "vehicle.md": vehicle_page,
    "rig.md": rig_page,
    "scenario.md": scenario_page,
    "campaign-file.md": campaign_file_page,
    "map-file.md": map_file_page,
    "signals.md": signals_page,
    "database.md": database_page,
    "c-interface.md": c_interface_page,
    "command-line.md": command_line_page,
    "http-api.md": http_api_page,
    "json.md": json_page,
    "equations.md": equations_page,
}
