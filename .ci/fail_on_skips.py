"""Where all is there that tests need, a skipped test is a failed one: reads pytest's JUnit XML; silent if all passed.

python .ci/fail_on_skips.py tests.xml [MORE.xml ...]
"""

import sys
from pathlib import Path
from xml.etree import ElementTree


def main(path: Path) -> int:
    """The exit status: 1 if a test failed or was skipped, or if none ran."""
    if not path.is_file():
        print(f"There is no {path.name}: pytest did not come to its end.")
        return 1
    passed, failed, skipped = 0, 0, []
    for case in ElementTree.parse(path).iter("testcase"):
        mark = case.find("skipped")
        if case.find("failure") is not None or case.find("error") is not None:
            failed += 1
        elif mark is not None and mark.get("type") != "pytest.xfail":
            skipped.append(f"{case.get('name')}: {(mark.text or mark.get('message') or '').strip()}")
        else:
            passed += 1
    if passed and not failed and not skipped:
        return 0
    if skipped:
        print(f"{len(skipped)} skipped, which counts as failed here:", *skipped, sep="\n  ")
    print(f"{passed} passed, {failed + len(skipped)} failed")
    return 1


if __name__ == "__main__":
    sys.exit(max(main(Path(path)) for path in sys.argv[1:]))
