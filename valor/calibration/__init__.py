"""An arm's drives and links, found of what its sensors say while it moves: data in, parameters out.

``record`` is what is known of a motion, ``servo`` finds each drive's law, ``dynamics`` friction and links, ``identify``
puts both together; ``poses`` are those that tell the most.
"""
