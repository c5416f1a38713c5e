"""The pictures that commands make: plots, films and reports, and the window to play in."""
