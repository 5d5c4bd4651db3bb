"""Start the Bag Recorder."""

import sys

from valor.bag_recorder.service import BagRecorder
from valor.service import run

if __name__ == "__main__":
    sys.exit(run("bag_recorder", BagRecorder))
