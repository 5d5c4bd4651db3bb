"""The hardware variant's test bench: one MuJoCo plant in real time, an emulator at the far end of each port."""
