"""Who may come to a robot from another machine: keys, certificates, and the door that they open."""
