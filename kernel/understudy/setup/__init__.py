"""From plugins and a configuration to built parts."""
