"""Bodies of flat faces, such as prisms, boxes and plates with holes, and arrays of any parts."""
