"""The turtle simulator: turtlesim 1.8.2 without a window, and without ROS if wanted.

The core is deterministic and does no input or output; each module imports only those above it:

    errors       the error of wrong arguments
    canvas       colours, pens, and the field: pixels for the colour sensor, strokes for pictures
    parameters   the node's parameters: background colour, holonomic
    turtle       one turtle: what a step of 16 ms does to it, and its rotation goal
    simulator    all turtles, and every request that turtlesim answers

A picture of the field, of a finished or a running simulator:

    field        the field with its trails and turtles as shapes, and as a file

Connected to others; one simulator to one of them:

    node         on a whiteboard: commands in, poses and colours out
    ros          turtlesim's whole graph, on any transport of llfsm.bridges.ros2
"""
