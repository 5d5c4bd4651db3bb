"""The parts of ``benchmarks/ipc.py``: transports, the processes at their ends, latency, and cost as a network grows."""
