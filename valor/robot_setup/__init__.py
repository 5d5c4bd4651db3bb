"""Creation of a robot's folder from its model; values that the model does not state are guessed and marked so.

``source`` reads MJCF or URDF; ``skeleton`` identifies legs, arms and neck; ``geometry`` and ``drives`` measure;
``posture`` solves the nominal posture; ``model_xml`` and ``robot_yaml`` write the folder; ``new`` runs them in order.
"""
