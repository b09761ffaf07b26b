// C++17 around the C of car.h: a sensor is an object.
#pragma once

#include "car.h"

#include <array>
#include <stdexcept>

namespace car {

using Channels = std::array<double, CAR_CHANNELS>;
using Estimate = car_estimate;

class Sensor {
  public:
    Sensor()
    {
        if (car_start(&sensor_, sizeof sensor_) != CAR_OK)
            throw std::logic_error("car: compiled with another header than its library");
    }

    /// Forget all samples.
    void restart() { car_restart(&sensor_); }

    /// Take in a sample; whether there is something to be said of it.
    bool update(const Channels &channels) { return car_update(&sensor_, channels.data(), &estimate_) == CAR_OK; }

    const Estimate &estimate() const { return estimate_; }

  private:
    car_sensor sensor_{};
    Estimate estimate_{};
};

} // namespace car
