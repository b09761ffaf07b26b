// A ROS 2 node around car_block.h: takes std_msgs/Float64MultiArray on ~/in, publishes one on ~/out every CAR_DT seconds.
// In the CMakeLists.txt of a package that finds ament_cmake, rclcpp and std_msgs:
//
//     add_executable(car_node car_node.cpp @SOURCES@)
//     ament_target_dependencies(car_node rclcpp std_msgs)
//     install(TARGETS car_node DESTINATION lib/${PROJECT_NAME})

#include "car_block.h"

#include <rclcpp/rclcpp.hpp>
#include <std_msgs/msg/float64_multi_array.hpp>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <memory>
#include <stdexcept>

class CarNode : public rclcpp::Node {
  public:
    using Message = std_msgs::msg::Float64MultiArray;

    CarNode() : rclcpp::Node("car")
    {
        if (car_block_start(&block_) != 0)
            throw std::logic_error("car: its files were compiled with different widths of vectors");
        in_.fill(CAR_BLOCK_HOLDS ? 0 : NAN);
        out_.data.resize(CAR_BLOCK_OUTPUTS);
        publisher_ = create_publisher<Message>("~/out", 1);
        subscription_ = create_subscription<Message>("~/in", 1, [this](const Message &message) { take(message); });
        timer_ = create_wall_timer(std::chrono::duration<car_signal>(CAR_DT), [this] { step(); });
    }

  private:
    static constexpr int longest = 3; // steps, from that of a message on, over which it counts

    void take(const Message &message)
    {
        if (message.data.size() != CAR_BLOCK_INPUTS) {
            RCLCPP_WARN(get_logger(), "a message of %zu numbers is left out; expected %d", message.data.size(),
                        CAR_BLOCK_INPUTS);
            return;
        }
        std::copy(message.data.begin(), message.data.end(), in_.begin());
        age_ = 0;
    }

    void step()
    {
        if (++age_ > longest && !CAR_BLOCK_HOLDS)
            in_.fill(NAN);
        car_block_step(&block_, now().seconds() - begun_, in_.data(), out_.data.data());
        publisher_->publish(out_);
#ifdef CAR_BLOCK_CLOCK_SET
        if (CAR_BLOCK_CLOCK_SET(&block_) != clock_set_)
            RCLCPP_WARN(get_logger(), "the clock was set; the time of one step is taken to have passed");
        clock_set_ = CAR_BLOCK_CLOCK_SET(&block_);
#endif
    }

    car_block block_{};
    std::array<car_signal, CAR_BLOCK_INPUTS + 1> in_{};
    Message out_;
    int age_ = 0;
    int64_t clock_set_ = 0;
    const car_signal begun_ = now().seconds();
    rclcpp::Publisher<Message>::SharedPtr publisher_;
    rclcpp::Subscription<Message>::SharedPtr subscription_;
    rclcpp::TimerBase::SharedPtr timer_;
};

int main(int n, char **words)
{
    rclcpp::init(n, words);
    rclcpp::spin(std::make_shared<CarNode>());
    rclcpp::shutdown();
    return 0;
}
