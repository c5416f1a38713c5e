"""The pictures that commands make: plots, films, reports, and episodes to watch or to play."""
