"""Independent answers, in float64 and with certificates: for `verify`, tests and benchmarks."""
