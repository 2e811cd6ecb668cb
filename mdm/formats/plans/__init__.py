"""Finite-state controllers and joint policies: policy graphs (`.pg`) and MADP's joint policies."""
