"""What tests and benchmarks set up alike: robots in process, whole systems, Bifrost networks; and waiting for them."""
