"""The transport of a team's messages: a session of Zenoh, or a simulated network; its limits and its security."""
