"""``python -m uavbench``."""

from uavbench.cli.app import app

if __name__ == "__main__":
    app(prog_name="uavbench")
