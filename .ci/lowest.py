"""Print the lowest versions that pyproject.toml declares, as pip takes them: of the dependencies, and of the extras named."""

import re
import sys
import tomllib
from pathlib import Path

project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
for each in sum((project["optional-dependencies"][name] for name in sys.argv[1:]), project["dependencies"]):
    name, lowest = re.match(r"([\w-]+)>=([\d.]+)", each).groups()
    print(f"{name}=={lowest}")
