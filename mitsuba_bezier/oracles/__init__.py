"""Independent float64 answers with certificates, for `verify`, tests and benchmarks."""
