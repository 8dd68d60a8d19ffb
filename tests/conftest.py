"""How long the fuzzed readers are tried: `ci` (hypothesis' own, the same cases each time) or `long`.

``pytest tests/robustness --hypothesis-profile=long`` draws other cases each time, many of them; what fails is kept in
.hypothesis and tried first the next time.
"""

from hypothesis import HealthCheck, settings

settings.register_profile(
    "long", max_examples=2000, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)
