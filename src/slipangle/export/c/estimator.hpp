// C++17 around the C of car.h: an estimator is an object.
#pragma once

#include "car.h"

#include <array>
#include <stdexcept>

namespace car {

using State = std::array<double, CAR_STATES>;
using Sample = car_sample;
using Estimate = car_estimate;

class Estimator {
  public:
    /// Before its first sample, where the state x is expected.
    explicit Estimator(const State &x = {})
    {
        if (car_start(&estimator_, sizeof estimator_, x.data()) != CAR_OK)
            throw std::invalid_argument("car: the state must be finite");
    }

    /// Forget the state but neither parameters nor offsets.
    void restart(const State &x)
    {
        if (car_restart(&estimator_, x.data()) != CAR_OK)
            throw std::invalid_argument("car: the state must be finite");
    }

    /// Take in a sample; whether it was, see car_update.
    bool update(const Sample &sample) { return car_update(&estimator_, &sample, &estimate_) == CAR_OK; }

    const Estimate &estimate() const { return estimate_; }

  private:
    car_estimator estimator_{};
    Estimate estimate_{};
};

} // namespace car
