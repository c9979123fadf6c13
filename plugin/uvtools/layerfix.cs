// layerfix as a UVtools script: Tools > Scripting > load this file, or `UVtoolsCmd run job.ctb layerfix.cs -o fixed.ctb`.
// Every layer of the chosen range goes to a folder of images, `layerfix` corrects them (greys are kept, nothing is taken
// away), and the images that changed come back. All else of the file stays UVtools' and the file's own.
// `layerfix` is a command on PATH, or the environment variable LAYERFIX says which.
using System;
using System.Diagnostics;
using System.Globalization;
using System.IO;
using Emgu.CV;
using Emgu.CV.CvEnum;
using UVtools.Core.Scripting;

namespace UVtools.ScriptSample
{
    public class ScriptLayerfix : ScriptGlobals
    {
        readonly ScriptNumericalInput<ushort> MinFeature = new ScriptNumericalInput<ushort>
        {
            Label = "Minimum feature",
            ToolTip = "Smallest dot or wall that survives on your machine",
            Unit = "µm",
            Minimum = 1,
            Maximum = 5000,
            Increment = 10,
            Value = 150
        };

        public void ScriptInit()
        {
            Script.Name = "layerfix";
            Script.Description = "Thickens what is thinner than your printer can make";
            Script.Author = "layerfix";
            Script.Version = new Version(0, 1);
            Script.UserInputs.Add(MinFeature);
        }

        public string ScriptValidate()
        {
            var pixel = Math.Max(SlicerFile.PixelWidth, SlicerFile.PixelHeight);
            if (pixel <= 0) return "This file does not say how large its pixels are: set the display's size first";
            if (MinFeature.Value < 1500 * pixel) return "The minimum feature is less than one and a half pixels";
            return "";
        }

        public bool ScriptExecute()
        {
            var folder = Path.Combine(Path.GetTempPath(), "layerfix-" + Guid.NewGuid().ToString("N"));
            var before = Path.Combine(folder, "before");
            var after = Path.Combine(folder, "after");
            Directory.CreateDirectory(before);
            try
            {
                var first = Operation.LayerIndexStart;
                var last = Operation.LayerIndexEnd;
                Progress.Reset("Writing layers", last - first + 1);
                for (var index = first; index <= last; index++)
                {
                    if (Progress.Token.IsCancellationRequested) return false;
                    using (var mat = SlicerFile[index].LayerMat)
                        CvInvoke.Imwrite(Path.Combine(before, Name(index)), mat);
                    Progress.LockAndIncrement();
                }
                Progress.Reset("Correcting layers", 1);
                var size = Number(SlicerFile.PixelWidth) + "mmx" + Number(SlicerFile.PixelHeight) + "mm";
                var arguments = "fix \"" + before + "\" \"" + after + "\" --mode add_only --pixel " + size + " --layer "
                    + Number(SlicerFile.LayerHeight) + "mm --min-feature " + MinFeature.Value + "um";
                var problem = Run(arguments);
                if (problem != "") throw new InvalidOperationException("layerfix: " + problem);
                Progress.Reset("Reading layers", last - first + 1);
                for (var index = first; index <= last; index++)
                {
                    if (Progress.Token.IsCancellationRequested) return false;
                    using (var was = CvInvoke.Imread(Path.Combine(before, Name(index)), ImreadModes.Grayscale))
                    using (var mat = CvInvoke.Imread(Path.Combine(after, Name(index)), ImreadModes.Grayscale))
                    using (var difference = new Mat())
                    {
                        CvInvoke.AbsDiff(was, mat, difference);
                        if (CvInvoke.CountNonZero(difference) > 0) SlicerFile[index].LayerMat = mat;
                    }
                    Progress.LockAndIncrement();
                }
                return !Progress.Token.IsCancellationRequested;
            }
            finally
            {
                Directory.Delete(folder, true);
            }
        }

        static string Name(uint index)
        {
            return index.ToString("D5", CultureInfo.InvariantCulture) + ".png";
        }

        static string Number(float value)
        {
            return value.ToString("0.######", CultureInfo.InvariantCulture);
        }

        // What went wrong, or nothing.
        string Run(string arguments)
        {
            var command = Environment.GetEnvironmentVariable("LAYERFIX") ?? "layerfix";
            var space = command.IndexOf(' ');
            var start = new ProcessStartInfo
            {
                FileName = space < 0 ? command : command.Substring(0, space),
                Arguments = (space < 0 ? "" : command.Substring(space) + " ") + arguments,
                UseShellExecute = false,
                RedirectStandardError = true
            };
            try
            {
                using (var process = Process.Start(start))
                {
                    var error = process.StandardError.ReadToEnd();
                    process.WaitForExit();
                    return process.ExitCode == 0 ? "" : error.Trim();
                }
            }
            catch (System.ComponentModel.Win32Exception)
            {
                return "not installed, or not on PATH: pip install layerfix, or set LAYERFIX to the command";
            }
        }
    }
}
