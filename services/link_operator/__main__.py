"""``python -m valor.link_operator``."""

import sys

from valor.link_operator.service import LinkOperator
from valor.service import run

sys.exit(run("link_operator", LinkOperator))
