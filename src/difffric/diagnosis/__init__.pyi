from .procedure import diagnose as diagnose
