"""Real cities: building footprints of OpenStreetMap or GeoJSON become the map of a scenario."""

from uavbench.geodata.importing import CityOptions, ImportedCity, import_city
from uavbench.geodata.libraries import GeodataError

__all__ = ["CityOptions", "GeodataError", "ImportedCity", "import_city"]
