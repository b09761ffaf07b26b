// As much of rclcpp, with the same names, as a node asks for: spin runs the recorded drive through it.
#pragma once
#include "../read.h"
#include "../std_msgs/msg/float64_multi_array.hpp"

#include <chrono>
#include <functional>
#include <memory>
#include <string>

namespace rclcpp {

using Array = std_msgs::msg::Float64MultiArray;
inline double time_now = 0;
inline std::function<void(const Array &)> on_message;
inline std::function<void()> on_timer;
inline double period = 0;

struct Time {
    double t;
    double seconds() const { return t; }
};
struct Logger {};
struct TimerBase {
    using SharedPtr = std::shared_ptr<TimerBase>;
};
template <class T> struct Subscription {
    using SharedPtr = std::shared_ptr<Subscription<T>>;
};
template <class T> struct Publisher {
    using SharedPtr = std::shared_ptr<Publisher<T>>;
    void publish(const T &message)
    {
        for (std::size_t i = 0; i < message.data.size(); i++)
            std::printf(i + 1 < message.data.size() ? "%.17g," : "%.17g\n", message.data[i]);
    }
};

class Node {
  public:
    using SharedPtr = std::shared_ptr<Node>;
    explicit Node(const std::string &) {}
    virtual ~Node() = default;
    Time now() const { return {time_now}; }
    Logger get_logger() const { return {}; }
    template <class T> typename Publisher<T>::SharedPtr create_publisher(const std::string &, int)
    {
        return std::make_shared<Publisher<T>>();
    }
    template <class T, class F> typename Subscription<T>::SharedPtr create_subscription(const std::string &, int, F taken)
    {
        on_message = taken;
        return std::make_shared<Subscription<T>>();
    }
    template <class R, class P, class F>
    TimerBase::SharedPtr create_wall_timer(std::chrono::duration<R, P> every, F called)
    {
        period = static_cast<double>(every.count());
        on_timer = called;
        return std::make_shared<TimerBase>();
    }
};

#define RCLCPP_WARN(logger, ...) ((void)(logger), (void)std::fprintf(stderr, __VA_ARGS__))

inline void init(int, char **) {}
inline void shutdown() {}
inline void spin(const Node::SharedPtr &)
{
    int columns = columns_of_heading();
    while (read_line(columns)) {
        Array message;
        time_now = SKIP ? recorded[SKIP - (SKIP > 0)] : 0;
        message.data.assign(recorded + SKIP, recorded + SKIP + INPUTS);
        on_message(message);
        message.data.push_back(0); // of another size: left out
        on_message(message);
        on_timer();
    }
    for (int silent = 0; silent < 5; silent++)
        on_timer();
}

} // namespace rclcpp
