"""The robot and what it holds as the control laws see them: closed chain, state, geometry."""
