// C++17 around the C of car.h: a driver is an object, its clock any callable.
#pragma once

#include "car.h"

#include <stdexcept>

namespace car {

using Measurements = car_measurements;
using Commands = car_commands;

class Driver {
  public:
    Driver()
    {
        if (car_start(&driver_, sizeof driver_) != CAR_OK)
            throw std::logic_error("car: compiled with other numbers per vector than its library");
    }
    Driver(const Driver &) = delete;
    Driver &operator=(const Driver &) = delete;

    /// Most iterations of a plan; 0 as exported.
    void limit(int iterations) { car_deadline(&driver_, iterations, 0.0, nullptr, nullptr); }

    /// Longest time of a plan [s], by a clock that returns seconds and outlives this.
    template <class Clock> void limit(int iterations, double seconds, Clock &clock)
    {
        car_deadline(
            &driver_, iterations, seconds, [](void *of) { return static_cast<car_seconds>((*static_cast<Clock *>(of))()); },
            &clock);
    }

    /// Take in what was measured and say what to do; throws where time goes back.
    const Commands &step(const Measurements &measured)
    {
        if (car_step(&driver_, &measured, &commands_) != CAR_OK)
            throw std::invalid_argument("car: times must be finite and not go back");
        return commands_;
    }

    const Commands &commands() const { return commands_; }

  private:
    car_driver driver_{};
    Commands commands_{};
};

} // namespace car
