/* Drive a turtle: ahead, and round where a wall is near. Ends when its whiteboard is removed.
 *
 *     cc -std=c11 -I whiteboard/include examples/drive_turtle.c -o drive_turtle
 *     llfsm turtlesim &
 *     ./drive_turtle
 */
#include "llfsm_whiteboard.h"
#include "messagepack.h"
#include "schemas.h"

struct pose { double x, y, theta; };

static void need(int status, const char *what)
{
    if (status == LWB_OK)
        return;
    fprintf(stderr, "drive_turtle: %s: %s%s%s\n", what, lwb_describe(status),
            status == LWB_SYSTEM ? ": " : "", status == LWB_SYSTEM ? strerror(errno) : "");
    exit(1);
}

static bool read_pose(struct lwb_slot *slot, struct pose *pose, uint64_t *count)
{
    unsigned char data[1024];
    struct lwb_meta meta;
    need(lwb_read(slot, data, sizeof data, &meta), "turtle1/pose");
    *count = meta.count;
    struct unpack u = {data, data + meta.length, meta.length <= sizeof data};
    unpack_array(&u, 5);
    pose->x = unpack_double(&u);
    pose->y = unpack_double(&u);
    pose->theta = unpack_double(&u);
    return u.good; /* what follows is of no interest here */
}

static void drive(struct lwb_slot *slot, double linear, double angular)
{
    const double twist[2][3] = {{linear, 0, 0}, {0, 0, angular}};
    unsigned char data[64];
    struct pack p = {data, data + sizeof data, true};
    pack_array(&p, 2);
    for (int part = 0; part < 2; part++) {
        pack_array(&p, 3);
        for (int axis = 0; axis < 3; axis++)
            pack_double(&p, twist[part][axis]);
    }
    if (p.good)
        need(lwb_add(slot, data, (size_t)(p.at - data), NULL), "turtle1/cmd_vel");
}

int main(int argc, char **argv)
{
    const char *name = argc > 1 ? argv[1] : getenv("WHITEBOARD_NAME");
    char path[PATH_MAX];
    snprintf(path, sizeof path, "/dev/shm/llfsm.%s", name ? name : "whiteboard");
    struct lwb_board board;
    struct lwb_slot poses, commands;
    need(lwb_open(&board, path, true), path);
    need(lwb_slot(&board, &poses, &POSE), POSE.name);
    need(lwb_slot(&board, &commands, &CMD_VEL), CMD_VEL.name);
    uint64_t seen = 0;
    while (lwb_linked(&board)) {
        struct pose pose;
        if (lwb_wait(&poses, seen, 1000000000) != LWB_OK || !read_pose(&poses, &pose, &seen))
            continue;
        bool near_wall = pose.x < 2 || pose.x > 9 || pose.y < 2 || pose.y > 9;
        drive(&commands, near_wall ? 1 : 2, near_wall ? 2 : 0);
    }
    lwb_close(&board);
    return 0;
}
