"""A robot's folder out of its model: what topology, geometry and symmetry tell is found, and marked as a guess.

``source`` reads MJCF or URDF; ``skeleton`` says which links and joints are legs, arms, neck; ``geometry`` and
``drives`` measure it; ``posture`` has it stand; ``model_xml`` and ``robot_yaml`` write the folder.
"""
