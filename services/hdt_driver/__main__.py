"""``python -m hdt_driver``."""

import sys

from hdt_driver.service import main

sys.exit(main())
