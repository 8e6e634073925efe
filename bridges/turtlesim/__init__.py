"""The turtle simulator: turtlesim 1.8.2 without ROS and without a window.

The core is deterministic and does no input or output; each module imports only those above it:

    errors       what a caller can do wrong
    arithmetic   turtlesim's numbers: its float32 roundings, its pi, the size of the field
    pen          colours and pens
    parameters   the node's parameters: background colour, holonomic
    stroke       a pen's trail, kept as the fewest points that show it
    canvas       the field that pens draw on: pixels for the colour sensor, strokes for pictures
    rotate       a goal of the action rotate_absolute
    turtle       one turtle: what a step of 16 ms does to it
    simulator    all turtles, and every request that turtlesim answers

Pictures of the field, drawn from a finished or a running simulator:

    shapes       what a picture is made of
    svg          shapes as SVG
    png          shapes as PNG (needs Pillow: the extra llfsm[draw])
    field        the field with its trails and turtles as shapes, and as a file

Connected to a whiteboard:

    node         commands in, poses and colours out
    command      llfsm turtlesim
"""
