"""Elements and attributes of a MuJoCo file, as far as it is read.

Taken from MuJoCo's own schema (``mj_printSchema`` of 3.2 to 4.0). Sections that say nothing about
what the robot is, such as sensors, actuators and looks, are not looked at.
"""

from __future__ import annotations

from coopqp.robot_files.schema import Known

_PLACE = "pos quat axisangle xyaxes zaxis euler"
_NOT_READ_SECTIONS = (
    "option size statistic visual extension contact deformable tendon actuator sensor custom "
    "keyframe"
)
_NOT_READ_DEFAULTS = (
    "texture material camera light pair equality tendon general motor position velocity "
    "intvelocity orientation pid damper cylinder muscle adhesion dcmotor plugin"
)


def _not_read(names: str) -> dict[str, str]:
    return dict.fromkeys(names.split(), "")


#: Words of URDF files, and what MuJoCo has for them.
OTHERWISE = {
    "revolute": "hinge",
    "continuous": "hinge",
    "prismatic": "slide",
    "floating": "free",
    "spherical": "ball",
    "link": "body",
    "collision": "geom",
    "visual": "geom",
    "origin": "pos",
    "xyz": "pos",
    "position": "pos",
    "rpy": "euler",
    "radius": "size",
    "length": "size",
    "filename": "file",
    "lower": "range",
    "upper": "range",
    "cube": "box",
    "ball": "sphere",
}

KNOWN: dict[str, Known] = {
    "mujoco": Known(
        "model",
        {
            "compiler": "compiler",
            "default": "default",
            "asset": "asset",
            "worldbody": "body",
            "equality": "equality",
            **_not_read(_NOT_READ_SECTIONS),
        },
    ),
    "compiler": Known(
        "alignfree angle assetdir autolimits balanceinertia boundinertia boundmass conflict "
        "convexhull coordinate discardvisual eulerseq exactmeshinertia fitaabb fusestatic "
        "inertiafromgeom inertiagrouprange meshdir passthrough savecanonical savecompiled "
        "saveinertial settotalmass strippath texturedir usethread",
        _not_read("lengthrange"),
    ),
    "default": Known(
        "class",
        {
            **{tag: tag for tag in ("default", "joint", "geom", "site", "mesh")},
            **_not_read(_NOT_READ_DEFAULTS),
        },
    ),
    "asset": Known("", {"mesh": "mesh", **_not_read("hfield skin texture material model")}),
    "mesh": Known(
        "builtin class content_type face file inertia material maxhullvert name normal "
        "octree_maxdepth params refpos refquat scale smoothnormal texcoord vertex",
        _not_read("plugin"),
    ),
    "body": Known(
        f"{_PLACE} childclass fuse gravcomp mocap name simple sleep user",
        {
            **{tag: tag for tag in ("body", "inertial", "joint", "freejoint", "geom", "site")},
            **_not_read("camera light plugin frame replicate attach composite flexcomp"),
        },
    ),
    "inertial": Known(f"{_PLACE} mass diaginertia fullinertia"),
    "joint": Known(
        "actuatorfrclimited actuatorfrcrange actuatorgravcomp armature axis class damping "
        "frictionloss group limited margin name pos range ref solimpfriction solimplimit "
        "solreffriction solreflimit springdamper springref springyield stiffness type user"
    ),
    "freejoint": Known("align group name"),
    "geom": Known(
        f"{_PLACE} adhesion castshadow class conaffinity condim contype density fitscale "
        "fluidcoef fluidshape friction fromto gap group hfield margin mass material mesh name "
        "priority rgba shellinertia size solimp solmix solref surfacevel type user",
        _not_read("plugin"),
    ),
    "site": Known(f"{_PLACE} class fromto group material mesh name rgba size type user"),
    "equality": Known(
        "", {"joint": "tie", **_not_read("connect weld tendon flex flexvert flexstrain distance")}
    ),
    "tie": Known("active class joint1 joint2 name polycoef solimp solref"),
}
