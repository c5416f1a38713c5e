"""Feed changed files and options to everything that reads them: nothing but errors that uavbench raises on purpose may come.

Usage::

    python tests/fuzz/fuzz.py                                   # 2,000 inputs, shared among all readers
    python tests/fuzz/fuzz.py --inputs 100000 geojson manifest  # a night, for two readers
    python tests/fuzz/fuzz.py --atheris map -runs=100000        # with atheris, which looks for inputs that reach new lines

Each input has 20 seconds, and the process 2 GB. What fails is printed as bytes, the shortest that Hypothesis finds.
"""

import argparse
import os
import resource
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "helpers")]

LONGEST = 20.0  # seconds for an input
MOST = 2 * 1024**2  # kilobytes of memory


class Hang(BaseException):
    """An input takes too long. It is no Exception, so that nobody takes it for an error of reading."""


def _hang(*_: object) -> None:
    raise Hang


def fed(name: str, inputs: int) -> Any:
    """Return a test by Hypothesis that feeds a reader, and counts in its attribute ``taken`` what was not refused."""
    from changes import changed
    from readers import READERS

    reader = READERS[name]
    with tempfile.TemporaryDirectory() as folder:
        examples = reader.examples(Path(folder))
    for example in examples:
        assert reader(example), f"{name}: a valid example is refused"
    taken: list[bool] = []

    @settings(
        max_examples=inputs,
        deadline=None,
        database=None,
        derandomize="CI" in os.environ,  # there, the inputs are the same each time
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )
    @given(changed(examples))
    def feed(content: bytes) -> None:
        signal.signal(signal.SIGALRM, _hang)
        signal.setitimer(signal.ITIMER_REAL, LONGEST)
        try:
            taken.append(reader(content))
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)

    feed.taken = taken  # type: ignore[attr-defined]
    return feed


def main() -> None:
    """Read the command line, feed the readers, and say what they did."""
    if "--atheris" in sys.argv:
        import atheris  # pyright: ignore[reportMissingImports]

        # Numba could not compile kernels that atheris watches.
        package = Path(__file__).parents[2] / "uavbench"
        kernels = [path for path in package.rglob("*.py") if "kernel" in path.read_text(encoding="utf-8")]
        unseen = [".".join(path.relative_to(package.parent).with_suffix("").parts) for path in kernels]
        with atheris.instrument_imports(include=["uavbench"], exclude=unseen):
            import readers
    import readers

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="READER", help=f"by default all: {', '.join(readers.READERS)}")
    parser.add_argument("--inputs", type=int, default=2000, help="how many inputs, in all")
    parser.add_argument("--atheris", action="store_true", help="use atheris for one reader; its own options follow")
    given, rest = parser.parse_known_args()
    names = given.names or list(readers.READERS)
    unknown = set(names) - set(readers.READERS)
    if unknown or (rest and not given.atheris) or (given.atheris and len(names) != 1):
        parser.error(f"readers are {', '.join(readers.READERS)}; --atheris takes one of them")
    if given.atheris:
        atheris.Setup([sys.argv[0], *rest], fed(names[0], 1).hypothesis.fuzz_one_input)
        atheris.Fuzz()
        return
    for name in names:
        begin, feed = time.perf_counter(), fed(name, max(1, given.inputs // len(names)))
        feed()
        used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        print(
            f"{name}: {len(feed.taken)} inputs, {sum(feed.taken)} taken, the others refused; "
            f"{time.perf_counter() - begin:.0f} s, {used // 1024} MB",
            flush=True,
        )
        assert used < MOST, f"{name}: more than 2 GB"


if __name__ == "__main__":
    main()
