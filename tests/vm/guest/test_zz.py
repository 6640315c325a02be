import subprocess, time, threading
from cable import UART, adapter, behind, plug, robot_file
from unit import ETC, prepared, reached
import pytest

def ps(what):
    print(f"\n=== {time.monotonic():.1f} {what}", flush=True)
    print(subprocess.run("ps -eo pid,time,cputimes,pcpu,etimes,rss,args --sort=-cputimes | head -14 | cut -c1-150", shell=True, capture_output=True, text=True).stdout, flush=True)

def test_zz(simulator, capsys):
    with capsys.disabled():
        plug()
        ps("plugged")
        robot = robot_file(ETC, UART, name="cart")
        end=threading.Event()
        def watch():
            while not end.wait(5): ps("")
        threading.Thread(target=watch, daemon=True).start()
        with behind(simulator, adapter()) as sim, prepared("cart"):
            ps("start")
            with reached("cart", sim) as u:
                ps("reached")
                time.sleep(20)
                print(u.said())
                u.drive_on()
                ps("drive on")
            ps("stop")
        ps("stopped"); end.set()
