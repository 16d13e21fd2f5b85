"""Hokuyo URG-04LX and URG-04LX-UG01 over SCIP 2.0."""
