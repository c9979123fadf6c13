@echo off
py -3 "%~dp0layerfix_chitubox.py" %*
