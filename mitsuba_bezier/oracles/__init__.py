"""Independent answers, certified in float64 or exact in rational numbers; no render uses them."""
