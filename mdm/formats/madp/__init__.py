"""The formats of MADP: `.dpomdp`, `.toi-dpomdp`, joint policies, Q-tables and value functions (`.vf`)."""
