"""Graph leaves on the device: charts, the certified march, grazing hits."""
