"""``python -m valor.hdt_driver``."""

import sys

from valor.hdt_driver.service import main

sys.exit(main())
