"""Table II as printed: return position errors in cm, runs 1 to 5 clockwise, 6 to 10 counter-clockwise."""

from typing import Final

import numpy as np

# Columns: without calibration without and with filter; with calibration without and with filter.
TABLE_II_CM: Final = np.array(
    [
        (94.4, 27.3, 8.9, 5.3),
        (80.2, 23.6, 9.8, 8.7),
        (75.8, 17.7, 15.8, 10.9),
        (92.5, 19.4, 9.4, 4.7),
        (72.3, 19.3, 25.9, 17.8),
        (124.4, 56.2, 24.9, 19.3),
        (146.8, 81.4, 21.8, 18.2),
        (133.8, 70.8, 20.1, 14.8),
        (111.4, 35.4, 10.8, 9.9),
        (145.4, 80.3, 15.0, 12.7),
    ]
)
