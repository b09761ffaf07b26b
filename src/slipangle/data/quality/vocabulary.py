"""What the channels of a car are called in logs of all kinds."""

from slipangle import units

WORDS = {
    "delta": (
        (
            "delta",
            "roadwheelangle",
            "steerangle",
            "steeringangle",
            "steeredangle",
            "lenkwinkel",
            "swa",
            "steer",
            "lenk",
            "stwhl",
            "strwhl",
        ),
        ("torque", "moment", "rate", "speed", "vel", "force", "rear", "hinter", "deltar$"),
    ),
    "delta_r": (
        (
            *("rearsteer", "rearroadwheel", "rearwheelangle", "rearaxlesteer", "steerrear", "steeringrear"),
            *("steeranglerear", "steeringanglerear", "hinterachslenk", "hinterradlenk", "deltarear", "deltar$"),
        ),
        ("torque", "moment", "rate", "speed", "vel", "force"),
    ),
    "M_z": (("yawmoment", "giermoment", "mz$"), ("rate", "tire", "tyre", "wheel")),
    "v_x": (
        (
            "vx",
            "wheelbasedvehiclespeed",
            "groundspeed",
            "vehiclespeed",
            "gpsspeed",
            "corrspeed",
            "vcar",
            "vveh",
            "vehspd",
            "vehspeed",
            "vehv",
            *("velocityx", "linearx", "speed", "velocity"),
            "geschwindigkeit",
            "v",
        ),
        (
            "wheel",
            "yaw",
            "engine",
            "rpm",
            "angular",
            "wind",
            "gyro",
            "steer",
            "vy",
            "lat",
            "fan",
            "turbo",
            "velocityy",
            "velocityz",
        ),
    ),
    "r": (
        (
            "yawrate",
            "yawvel",
            "gyroyaw",
            "gyroz",
            "angularvelocityz",
            "ratez",
            "angularz",
            "gierrate",
            "wz",
            "psidot",
            "yaw",
            "r",
        ),
        ("acc", "angle", "moment", "pos"),
    ),
    "a_y": (
        (
            "ay",
            "latacc",
            "lateralacc",
            "accy",
            "accely",
            "glat",
            "glateral",
            "accelerationy",
            "gforcelat",
            "gforcey",
            "queracc",
            "acclat",
        ),
        ("angular",),
    ),
    "v_y": (("vy", "lateralvel", "latvel", "lateralspeed", "velocityy", "lineary"), ("angular", "gyro", "acc")),
}
"""Words of a name, plain, by the standard one: the first that fits is taken, and no name with one of the second list.
A dollar stands for the end of the name."""
QUANTITY = {"delta": "angle", "v_x": "speed", "r": "angular rate", "a_y": "acceleration", "v_y": "speed"}
QUANTITY |= {"delta_r": "angle", "M_z": units.quantity("N m")}
"""What they measure, by the standard name."""
