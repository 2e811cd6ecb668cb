"""What carries a team's messages: a session of Zenoh, or a simulated network; how it is limited and guarded."""
