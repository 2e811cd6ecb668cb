"""Alpha vectors as text and XML: `.vf`, `.alpha`, and the policies of SARSOP and ZMDP."""
