"""`python -m armctl`."""

from armctl.cli import main

main()
