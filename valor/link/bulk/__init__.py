"""Things that are too large for the slow channel: fetched over the fast one in chunks, as its windows allow.

The operator's end asks for chunks and keeps what has come; the robot's end answers, and remembers nothing. So whoever
asks sets the pace, a blackout is a time without answers, and either end may begin anew.
"""
