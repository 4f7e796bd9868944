"""An axis as an EPICS motor record: the record, its link to the nodes, and the Channel Access server."""
