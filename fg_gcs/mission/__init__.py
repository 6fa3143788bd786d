"""Mission files: what is to be flown, checked before anything starts."""

from fg_gcs.mission.formats.toml import load_mission, parse_mission
from fg_gcs.mission.model import Mission

__all__ = ["Mission", "load_mission", "parse_mission"]
