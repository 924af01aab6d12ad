"""The links of an arm on its force axes: whole-arm motion → payload, masses of links, and adjusted inertial parameters."""
