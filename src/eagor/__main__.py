"""``python -m eagor`` is the same as ``eagor``."""

import sys

from eagor.cli import main

if __name__ == "__main__":
    sys.exit(main())
