"""``python -m mdm``: the same as the command ``mdm``."""

import sys

from mdm.cli import main

sys.exit(main())
