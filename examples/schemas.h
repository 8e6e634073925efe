/* Made by schemas.py. */
static const struct lwb_schema CMD_VEL = {
    "turtle1/cmd_vel", "geometry_msgs/msg/Twist",
    "{\"title\":\"geometry_msgs/msg/Twist\",\"type\":\"object\",\"properties\":{\"linear\":{\"title\":\"geometry_msgs/msg/Vector3\",\"type\":\"object\",\"properties\":{\"x\":{\"type\":\"number\"},\"y\":{\"type\":\"number\"},\"z\":{\"type\":\"number\"}},\"required\":[\"x\",\"y\",\"z\"]},\"angular\":{\"title\":\"geometry_msgs/msg/Vector3\",\"type\":\"object\",\"properties\":{\"x\":{\"type\":\"number\"},\"y\":{\"type\":\"number\"},\"z\":{\"type\":\"number\"}},\"required\":[\"x\",\"y\",\"z\"]}},\"required\":[\"linear\",\"angular\"]}",
    0x307a2937959cbc77u, 1024};
static const struct lwb_schema POSE = {
    "turtle1/pose", "turtlesim/msg/Pose",
    "{\"title\":\"turtlesim/msg/Pose\",\"type\":\"object\",\"properties\":{\"x\":{\"type\":\"number\"},\"y\":{\"type\":\"number\"},\"theta\":{\"type\":\"number\"},\"linear_velocity\":{\"type\":\"number\"},\"angular_velocity\":{\"type\":\"number\"}},\"required\":[\"x\",\"y\",\"theta\",\"linear_velocity\",\"angular_velocity\"]}",
    0x65aac937e25249cfu, 1024};
