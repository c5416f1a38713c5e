"""The commands that `uavbench.cli` puts together, a group a file. No logic is in them."""
