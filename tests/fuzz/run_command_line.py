"""Runs command lines of armctl in a process of its own: see `test_command_lines.py`."""

import json
import sys
from pathlib import Path

from child import serve

sys.path.append(str(Path(__file__).parents[1]))

from command_line import armctl


def check(path):
    """Run the words in a file, in the folder of the file, and return exit status, standard output and error as JSON."""
    try:
        done = armctl(*json.loads(path.read_text()), cwd=path.parent, check=False)
    except KeyboardInterrupt as error:
        raise AssertionError("an interrupt escaped") from error
    done.stdout.encode()  # standard output is strict, standard error is not
    return json.dumps([done.returncode, done.stdout, done.stderr])


if __name__ == "__main__":
    serve(check)
