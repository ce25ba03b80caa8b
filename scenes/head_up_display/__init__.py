"""Head-up display of a car that the sun shines into: windscreen, freeform mirror, display with its cover."""
