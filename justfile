# Short names for what is done often: https://just.systems. `.ci/run` is what must pass before anything lands.
set shell := ["bash", "-euo", "pipefail", "-c"]
set positional-arguments

export PATH := justfile_directory() / ".venv/bin" + ":" + env("PATH")

# Show the recipes.
default:
    @just --list

# Make the virtual environment with everything that the tests need.
setup:
    python3 -m venv .venv
    .venv/bin/pip install -e '.[ddqn,dev,onnx]'
    .venv/bin/pre-commit install

# Run the quick tests; what follows goes to pytest: just test tests/world -x
test *arguments:
    pytest -n 2 --dist=worksteal "$@"

# Run the slow tests.
slow *arguments:
    pytest -m slow -n 2 --dist=worksteal "$@"

# Check style and format.
lint:
    ruff check .
    ruff format --check .

# Check types.
types:
    pyright

# Build the documentation into docs/_build, and run its examples.
docs:
    sphinx-build -W -b html docs docs/_build
    sphinx-build -q -W -b doctest docs docs/_build/doctest

# Build the wheel into dist.
build:
    python -m build --wheel

# Replay all submissions, and build the leaderboard.
board:
    uavbench leaderboard build leaderboard/submissions --workers 2

# Run everything that must pass, on a clean clone of what is committed.
ci:
    bash .ci/run
