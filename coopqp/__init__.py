"""coopqp: QP control of robots that hold one object with several arms.

    import coopqp

    scenario = coopqp.load("scenarios/point_on_point.yaml")
    comparison = coopqp.compare(scenario)

Names are imported when first used, so that ``coopqp --help`` need not wait for pinocchio. Which
names there are, and where they live, is written once, in ``__init__.pyi``.
"""

import lazy_loader

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]
