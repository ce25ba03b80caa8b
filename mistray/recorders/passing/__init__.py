"""Light that is recorded in passing: by place and direction on a rectangle in space, or by direction far away."""
