"""The formats of APPL's SARSOP: factored models (`.pomdpx`) and policies (`.policy`, `.policyx`)."""
