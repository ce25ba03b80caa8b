"""Double Gauss in a blackened barrel with a hood; surfaces scatter."""
