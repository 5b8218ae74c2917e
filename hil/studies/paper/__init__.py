"""The paper's claims (Xu, Cai, Zou 2013) as runnable experiments."""
