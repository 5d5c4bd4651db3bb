"""Start the Bag Recorder."""

import sys

from bag_recorder.service import BagRecorder
from valor_common.service import run

if __name__ == "__main__":
    sys.exit(run("bag_recorder", BagRecorder))
