"""Report of a ghost analysis: summary, fields, and ledgers of energy and surfaces."""
