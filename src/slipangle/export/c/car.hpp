// C++17 around the C of car.h: a controller is an object, its clock any callable.
#pragma once

#include "car.h"

#include <stdexcept>

namespace car {

using Input = car_input;
using Output = car_output;

class Controller {
  public:
    Controller()
    {
        if (car_start(&controller_, sizeof controller_) != CAR_OK)
            throw std::logic_error("car: compiled with another CAR_LANES than its library");
    }
    Controller(const Controller &) = delete;
    Controller &operator=(const Controller &) = delete;

    /// Most iterations of a plan; 0 as exported.
    void limit(int iterations) { car_deadline(&controller_, iterations, 0.0, nullptr, nullptr); }

    /// Longest time of a plan [s], by a clock that returns seconds and outlives this.
    template <class Clock> void limit(int iterations, double seconds, Clock &clock)
    {
        car_deadline(
            &controller_, iterations, seconds, [](void *of) { return static_cast<car_seconds>((*static_cast<Clock *>(of))()); },
            &clock);
    }

    /// Plan from the state now; the same as car_plan.
    const Output &plan(const Input &input)
    {
        car_plan(&controller_, &input, &output_);
        return output_;
    }

    const Output &output() const { return output_; }

  private:
    car_controller controller_{};
    Output output_{};
};

} // namespace car
