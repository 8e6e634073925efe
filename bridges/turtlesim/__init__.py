"""The turtle simulator: turtlesim 1.8.2 without a window, and without ROS if wanted.

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

    field        the field with its trails and turtles as shapes, and as a file

Connected to others; one simulator to one of them:

    node         on a whiteboard: commands in, poses and colours out
    ros_turtle   a turtle on a ROS graph: its topics, services and action
    ros          turtlesim's whole graph, on any transport of llfsm.bridges.ros2
    command      llfsm turtlesim
"""
