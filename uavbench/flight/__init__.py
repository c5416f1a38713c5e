"""Out of the grid: mission files for autopilots."""
