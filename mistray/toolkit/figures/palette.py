"""Colours for categories: the palette of Okabe and Ito, distinguishable for colour-blind readers, and a few more."""

BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILION, PURPLE = (
    "#000000", "#e69f00", "#56b4e9", "#009e73", "#f0e442", "#0072b2", "#d55e00", "#cc79a7",
)  # fmt: skip
GREY, BROWN, PINK, INDIGO = "#7f7f7f", "#8a6d1d", "#f4a3c0", "#332288"
