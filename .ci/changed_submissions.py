"""Replay the submissions to the leaderboard that the last commit of a checkout changes, and print a summary in Markdown.

Usage: python .ci/changed_submissions.py CHECKOUT. The last commit is compared with its first parent: for the merge of a pull
request, that is the base branch. The exit status is 1 when something is refused.

Names and contents in the checkout may come from anybody. No name reaches a shell. What does not have the form of a submission
is refused. All text of the checkout is escaped in the summary.
"""

import html
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

SUBMISSIONS = Path("leaderboard", "submissions")
FORM = re.compile(r"leaderboard/submissions/([a-z0-9][a-z0-9._+-]*)/([A-Za-z0-9][A-Za-z0-9._-]*)/[A-Za-z0-9._-]+")
PLAIN = {"100644", "000000"}  # git's modes of a plain file, and of one that is gone


def changed(checkout: Path) -> tuple[set[Path], list[str]]:
    """Return the folders of submissions that the last commit changes, and a line for each path that belongs to none."""
    command = ["git", "-C", checkout, "diff", "--raw", "-z", "--no-renames", "HEAD^1", "HEAD", "--", SUBMISSIONS.as_posix()]
    fields = subprocess.run(command, check=True, capture_output=True).stdout.decode(errors="backslashreplace").split("\0")
    folders: set[Path] = set()
    strange: list[str] = []
    for about, name in zip(fields[:-1:2], fields[1::2], strict=True):
        found = FORM.fullmatch(name)
        mode = about.split()[1]
        if found is None and mode != "000000":
            strange.append(f"{name!a}: not a file leaderboard/submissions/<name>/<scenario>/<file>")
        elif mode not in PLAIN:
            strange.append(f"{name!a}: not a plain file, or an executable one (git's mode {mode})")
        elif found is not None:
            folders.add(SUBMISSIONS / found[1] / found[2])
    return folders, strange


def verify(checkout: Path, folders: list[Path]) -> tuple[int, str]:
    """Replay copies of these submissions and of no others; return the exit status and what was printed."""
    with tempfile.TemporaryDirectory() as copies:
        for folder in folders:
            shutil.copytree(checkout / folder, Path(copies, *folder.parts[-2:]), symlinks=True)
        # -I: no module is looked for in the current folder, in which the checkout may be.
        command = [sys.executable, "-I", "-m", "uavbench", "leaderboard", "verify", copies, "--workers", "2"]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
        return done.returncode, done.stdout


def main(checkout: Path) -> int:
    """Print the summary, and return the exit status."""
    root = checkout.resolve()
    folders, refused = changed(root)
    there = sorted(folder for folder in folders if (root / folder).is_dir())
    gone = sorted(folder.relative_to(SUBMISSIONS).as_posix() for folder in folders.difference(there))
    linked = [folder for folder in there if (root / folder).resolve() != root / folder]
    refused += [f"{folder.as_posix()!a}: behind a link" for folder in linked]
    status, text = verify(root, there) if there and not refused else (0, "")
    lines = [
        *(f"refused: {line}" for line in refused),
        *text.splitlines(),
        *(f"removed: {name}" for name in gone),
    ]
    failed = bool(refused) or status != 0
    print("### Submissions to the leaderboard\n")
    if failed:
        print("**Not accepted.** The lines below say which submission is refused, and why.\n")
    elif there:
        print(f"**Every number is reproduced**, in {len(there)} of {len(there)} changed submissions.\n")
    else:
        print("No submission is added or changed.\n")
    print(f"<pre>\n{html.escape(chr(10).join(lines))}\n</pre>\n")
    print("Whose a name is, is checked when the leaderboard is built. The rules are in `docs/leaderboard.md`.")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
