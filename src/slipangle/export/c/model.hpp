// C++17 around the C of car.h: a model with its state.
#pragma once

#include "car.h"

#include <array>

namespace car {

using State = std::array<double, CAR_STATES>;
using Inputs = std::array<double, CAR_INPUTS_SIZE>;
using Outputs = std::array<double, CAR_OUTPUTS>;

class Model {
  public:
    explicit Model(const State &x = {}) : x_(x) {}

    const State &state() const { return x_; }

    /// Outputs now.
    Outputs output(const Inputs &u) const
    {
        Outputs y{};
        car_output(x_.data(), u.data(), y.data());
        return y;
    }

    /// One sample later, the inputs held.
    void step(const Inputs &u)
    {
        const State x = x_;
        car_step(x.data(), u.data(), x_.data());
    }

    /// What was measured now.
    void correct(const Inputs &u, const Outputs &y)
    {
        const State x = x_;
        car_correct(x.data(), u.data(), y.data(), x_.data());
    }

  private:
    State x_;
};

} // namespace car
