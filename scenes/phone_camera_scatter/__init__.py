"""Phone camera whose surfaces scatter: prescription and scene.xml."""
