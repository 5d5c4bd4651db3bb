"""The recorder as a process: a real daemon, real publishers on both sides, and the bag read by others' tools."""
