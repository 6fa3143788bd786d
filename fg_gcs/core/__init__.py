"""Pure mathematics: no clock, no input or output, no logging, no randomness.

Letters used in array shapes everywhere in this program, time first:

    T  instants            V  vehicles (leaders first, then followers)
    N  leaders on the rim  M  followers behind the face
    K  poses along a path  S  points along a path parameter
"""
