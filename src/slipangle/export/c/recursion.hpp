// C++17 around the C of car.h: a recursion is an object.
#pragma once

#include "car.h"

#include <array>
#include <stdexcept>

namespace car {

using Outputs = std::array<double, CAR_OUTPUTS>;
using Inputs = std::array<double, CAR_INPUTS>;
using Estimate = car_estimate;

class Recursion {
  public:
    Recursion()
    {
        if (car_start(&recursion_, sizeof recursion_) != CAR_OK)
            throw std::logic_error("car: compiled with another header than its library");
    }

    /// Forget past outputs and inputs but not the estimate.
    void restart() { car_restart(&recursion_); }

    /// Take in a sample; whether all its numbers were finite, and none so large that the estimate would not stay so.
    bool update(const Outputs &y, const Inputs &u)
    {
        return car_update(&recursion_, y.data(), u.data(), &estimate_) == CAR_OK;
    }

    const Estimate &estimate() const { return estimate_; }

  private:
    car_recursion recursion_{};
    Estimate estimate_{};
};

} // namespace car
