"""Text or calls -> Mechanism. No kinematics here."""
