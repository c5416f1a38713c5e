"""Out of the grid: mission files for autopilots, and flights with physics."""
