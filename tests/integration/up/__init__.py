"""One robot under `valorctl up` with page, camera and Foxglove, before browsers, tools and programs."""
