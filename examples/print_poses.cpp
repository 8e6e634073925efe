// Print where a turtle is, whenever it changes, until its whiteboard is removed.
//
//     c++ -std=c++17 -I whiteboard/include examples/print_poses.cpp -o print_poses
//     llfsm turtlesim &
//     ./print_poses
#include "llfsm_whiteboard.h"
#include "messagepack.h"
#include "schemas.h"

#include <array>
#include <iostream>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

struct Pose {
    double x, y, theta, linear_velocity, angular_velocity;
};

void need(int status, const std::string &what)
{
    if (status != LWB_OK)
        throw std::runtime_error(what + ": " + lwb_describe(status));
}

class Board {
public:
    explicit Board(const std::string &path) { need(lwb_open(&board, path.c_str(), true), path); }
    ~Board() { lwb_close(&board); }
    Board(const Board &) = delete;
    Board &operator=(const Board &) = delete;

    bool is_there() const { return lwb_linked(&board); }

    lwb_board board;
};

class PoseReader {
public:
    explicit PoseReader(Board &board) { need(lwb_slot(&board.board, &slot, &POSE), POSE.name); }

    // The latest pose if there is a newer one within 50 ms.
    std::optional<Pose> next()
    {
        if (lwb_wait(&slot, count, 50'000'000) != LWB_OK)
            return std::nullopt;
        struct lwb_meta meta = {};
        need(lwb_read(&slot, data.data(), data.size(), &meta), POSE.name);
        count = meta.count;
        struct unpack u = {data.data(), data.data() + meta.length, meta.length <= data.size()};
        unpack_array(&u, 5);
        std::array<double, 5> values;
        for (double &value : values)
            value = unpack_double(&u);
        if (!u.good)
            return std::nullopt;
        return Pose{values[0], values[1], values[2], values[3], values[4]};
    }

private:
    struct lwb_slot slot; // the keyword because there is a function of that name
    std::vector<unsigned char> data = std::vector<unsigned char>(POSE.capacity);
    std::uint64_t count = 0;
};

int main(int argc, char **argv)
try {
    const char *name = argc > 1 ? argv[1] : std::getenv("WHITEBOARD_NAME");
    Board board(std::string("/dev/shm/llfsm.") + (name ? name : "whiteboard"));
    PoseReader poses(board);
    while (board.is_there()) {
        if (const auto pose = poses.next())
            std::cout << pose->x << ' ' << pose->y << ' ' << pose->theta << std::endl;
    }
} catch (const std::exception &error) {
    std::cerr << "print_poses: " << error.what() << '\n';
    return 1;
}
